"""Motion sequences: read and written in the format of ATOM's recorder, and generated from a seed."""
