"""Declarative documents: a record is a frozen dataclass that defines reading, writing and the JSON Schema.

A record's fields carry their type, default, limits, unit and one sentence of help::

    @record
    class Limits:
        '''The largest values that pass, in every cell.'''

        rms_px: Annotated[float, at_least(0)] | None = field("Root mean square of the table's errors", unit="px")

    limits = read(Limits, {"rms-px": 3}, "calibration.yml: limits")     # Limits(rms_px=3.0)
    read(Limits, {"rms-px": -1}, "calibration.yml: limits")
        # InputError: calibration.yml: limits.rms-px: found -1, expected a number of at least 0
    document_of(limits)                                                 # {"rms-px": 3.0}
    schema_of(Limits)            # of `calibration.base.records.schema`: the JSON Schema, for editors

Types of fields: ``str``, ``int``, ``float``, ``bool``, ``Path`` (relative to the folder of the file), ``Literal``,
``tuple[T, ...]``, ``Mapping[str, T]``, records, unions, and ``T | None`` for what may be absent; each with limits in
``Annotated``: `at_least`, `between`, `above`, `matching`, `length`, `UNIQUE`. A field declared without `field`
is not part of the document.

- ``key="from"`` sets another key than the field's name in kebab-case (in snake_case with ``@record(case="snake")``).
- ``flat=True``: the keys of the nested record are keys of the outer record.
- `Converted`: a value whose form in the document (``10m``) differs from that in the record (600.0).
- `ByName`: a mapping whose keys are the names of the nested records.
- ``@record(rules=...)``: conditions on keys: `excludes`, `needs`, `one_of`, `exactly_one`; other conditions on
  values are checked in ``__post_init__``, which raises `Misfit`.
- ``@result`` declares a record of results: keys in snake_case, null for None, and unknown keys of newer versions
  are ignored. ``@property`` above ``@computed()`` is a key that is written and never read.

All imports are fast, so that a command may declare its options by a record. No validation library is used:
pydantic takes longer to import than all of this command line, and needs as many lines as `conversion` to tell an absent
key from null, a list from a text, and to name the key.
"""

from calibration.base.records.conversion import changed, document_of, read, read_as, text_of, value_of
from calibration.base.records.declaration import (
    UNIQUE,
    ByName,
    Constraint,
    Converted,
    Misfit,
    Place,
    above,
    at_least,
    between,
    computed,
    exactly_one,
    excludes,
    field,
    flat_fields,
    length,
    matching,
    needs,
    one_of,
    record,
    result,
    shown,
    unknown_key,
    with_fields,
)
