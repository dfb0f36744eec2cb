"""The page ``report.html``: `whole` composes it, the other modules are its parts about one system."""
