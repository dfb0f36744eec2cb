"""The motion recorder: a page in the browser where poses are set by hand, seen by every sensor, and saved."""
