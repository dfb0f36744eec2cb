"""Campaigns of attack: wrong input without end (``make fuzz``) and failing machines (``make faults``), by seeds."""
