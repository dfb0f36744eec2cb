"""How far a starting guess may be off: the matrix swept over start noise, as maps of what converges."""
