"""Ground floor: what every other floor uses. It knows nothing of calibration, and imports no other floor.

This page hands out what most modules need: errors, text, files and documents. The rest is imported from its module.

- ``errors``: exceptions for users, and exit codes; ``text``: text for messages, secrets in them;
- ``files``, ``process``: the operating system;
- ``documents``, ``http``: untrusted documents read in bounds;
- ``records``: documents declared once, with their reading, writing and JSON Schemas;
- ``tables``: tables of files, and rules over them; ``verdict``: a value against its limit;
- ``arrays``: array types.
"""

from calibration.base.documents import RepeatedKeyError as RepeatedKeyError
from calibration.base.documents import line_of as line_of
from calibration.base.documents import parse_json as parse_json
from calibration.base.documents import parse_json_of as parse_json_of
from calibration.base.documents import read_json as read_json
from calibration.base.documents import read_yaml as read_yaml
from calibration.base.documents import with_variables as with_variables
from calibration.base.errors import CalibrationError as CalibrationError
from calibration.base.errors import ExitCode as ExitCode
from calibration.base.errors import InfrastructureError as InfrastructureError
from calibration.base.errors import InputError as InputError
from calibration.base.errors import UndeterminedError as UndeterminedError
from calibration.base.errors import brief as brief
from calibration.base.errors import exit_code_of as exit_code_of
from calibration.base.errors import innermost_message as innermost_message
from calibration.base.errors import solvable as solvable
from calibration.base.files import follow_no_links as follow_no_links
from calibration.base.files import link_or_copy as link_or_copy
from calibration.base.files import read_bytes as read_bytes
from calibration.base.files import temporary_folder as temporary_folder
from calibration.base.files import write_atomically as write_atomically
from calibration.base.files import writing as writing
from calibration.base.text import aligned as aligned
from calibration.base.text import code_block as code_block
from calibration.base.text import count_of as count_of
from calibration.base.text import did_you_mean as did_you_mean
from calibration.base.text import escape_markdown as escape_markdown
from calibration.base.text import markdown_table as markdown_table
from calibration.base.text import not_a_number as not_a_number
from calibration.base.text import number_text as number_text
from calibration.base.text import one_line as one_line
from calibration.base.text import parse_number as parse_number
from calibration.base.text import rounded as rounded
from calibration.base.text import shorten as shorten
from calibration.base.text import visible as visible
from calibration.base.text import with_error_bar as with_error_bar
from calibration.base.text import without_escapes as without_escapes
