"""Ground floor: what every other floor uses. It knows nothing of calibration, and imports no other floor.

- ``errors``: exceptions for users, and exit codes; ``text``, ``redaction``: text for messages, secrets in them;
- ``files``, ``process``: the operating system;
- ``documents``, ``http``: untrusted documents read in bounds;
- ``records``: documents declared once, with their reading, writing and JSON Schemas;
- ``tables``: tables of files, and rules over them; ``verdict``: a value against its limit;
- ``arrays``: array types.
"""
