"""Static analysis of a repository: analysers run on a copy of its files, and only what a change brings in counts.

Knows nothing of calibration, and runs nothing of what it analyses.

- ``finding``: what an analyser says of a line;
- ``copies``: the tracked files, and those of an earlier commit, as folders without links;
- ``programs``, ``analysers``: the programs that are started, one module each, and what they say as findings;
- ``comparison``, ``suppressions``, ``limits``: which findings are new, which are accepted, how many may be;
- ``sarif``, ``results``, ``report``: how they are written and shown;
- ``process``: the process of the command.
"""
