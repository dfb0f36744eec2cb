"""``report.html``: `whole` composes the page, the other modules its parts about one system."""
