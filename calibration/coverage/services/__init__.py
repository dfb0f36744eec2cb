"""Services that keep the coverage of commits and show it."""
