"""One page that opens offline: HTML, tables and figures as inline SVG; knows nothing of calibration."""
