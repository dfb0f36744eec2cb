"""``python -m benchmarks.trust.mistakes [WORD]``: every recording and mistake, or those with a word in their names."""

import sys

from benchmarks.trust.mistakes import cases
from benchmarks.trust.mistakes.recordings import missing


def main() -> int:
    """Print each case; 1 if one is not as it should be."""
    if reason := missing():
        print(reason)
        return 0
    right = []
    for case in cases(only=" ".join(sys.argv[1:])):
        print(case.line(), flush=True)
        right.append(case.is_right)
    print(f"{sum(right)} of {len(right)} right")
    return 0 if all(right) else 1


if __name__ == "__main__":
    sys.exit(main())
