"""The commands: one module per action and verb, each from inputs to an exit code.

Importing a module of this package imports nothing heavy; what a command needs is imported when it
runs. Each module has a click command named ``command`` whose callback returns an exit code.
"""
