"""HTML pages that open offline, with tables and figures as inline SVG; independent of calibration."""
