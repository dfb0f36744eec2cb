"""The commands: one module per action and verb, each from inputs to an exit code.

`calibration.__main__` imports a module when its command is called, so that what it needs stands at its head. Each
module has a click command named ``command`` whose callback returns an exit code.
"""
