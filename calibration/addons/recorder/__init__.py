"""Motion recorder: a web page on which poses are set by hand, previewed for every sensor, and saved."""
