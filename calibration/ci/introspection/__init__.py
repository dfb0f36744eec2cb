"""Rule files, and the report of rules over tables."""
