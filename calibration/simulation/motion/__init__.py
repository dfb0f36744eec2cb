"""Motion sequences: read and written as ATOM's recorder does, and generated from a seed."""
