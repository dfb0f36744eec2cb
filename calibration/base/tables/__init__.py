"""Rules over tables and the resulting verdict.

    table = read_table("rgb_to_rgb_results.csv")
    rules = parse_rules([{"column": "RMS (pix)", "row": "Averages", "max": 3}], where="calibration.yml: rules")
    verdict = judge(table, rules)

Rule files are read by :mod:`calibration.ci.introspection`, which needs YAML.
Independent of calibration: any table with a header can be judged.
"""

from calibration.base.tables.rules import RuleSet, parse_rules
from calibration.base.tables.table import Table, read_table
from calibration.base.tables.table_verdict import RuleResult, TableResult, Violation, judge
