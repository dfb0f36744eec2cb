"""Static analysis of a repository: analysers run on a copy of its files, and only new findings of a change count.

Knows nothing of calibration, and runs nothing of what it analyses.

- ``finding``: a finding of an analyser at a line;
- ``copies``: the tracked files, and those of an earlier commit, as folders without links;
- ``programs``, ``analysers``: the external programs, one module each, and their output as findings;
- ``comparison``, ``suppressions``, ``limits``: new findings, accepted findings, and limits of their number;
- ``sarif``, ``results``, ``report``: the output formats;
- ``process``: the process of the command.
"""
