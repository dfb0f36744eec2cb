"""Commands of the command line and the actions, from options to an exit code: one module for those of one subject.

`calibration.__main__` names the module of each, and imports it only when the command is called, so modules may import
what they need. The callback of a click command returns an exit code.
"""
