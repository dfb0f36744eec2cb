"""Commands of the command line and the actions: one module each, from options to an exit code.

`calibration.__main__` imports a module only when its command is called, so modules may import what they need. Each
has a click command named ``command`` whose callback returns an exit code.
"""
