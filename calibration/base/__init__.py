"""Ground floor: what every other floor uses. It knows nothing of calibration, and imports no other floor.

- ``errors``: exceptions for users, and exit codes; ``text``, ``secret_forms``: text for messages, secrets in them;
- ``files``, ``temporary_folder``, ``file_patterns``, ``programs``, ``signals``, ``process_end``: the operating system;
- ``yaml_file``, ``json_file``, ``http``: untrusted documents read in bounds, documents written;
- ``records``: documents declared once, with their reading, writing and JSON Schemas;
- ``tables``: tables of files, and rules over them; ``check``, ``verdict``: a value against its limit;
- ``arrays``: array types.
"""
