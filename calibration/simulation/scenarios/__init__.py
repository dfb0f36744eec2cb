"""Many scenarios instead of one: what varies between them, each addressed by its id, and what drives the error."""
