"""The same work several times: how long each run takes, what differs between them, and from which stage on.

- ``settings``: how often, and what is allowed to differ;
- ``repetition``: one run: its times, outcomes, numbers, transforms and the hashes of its outputs;
- ``comparison``: runs beside each other: spreads, and the first stage that differs;
- ``results``, ``report``: what was found, and how it is shown;
- ``running``: the loop; ``pipeline_runs``: the stages of a run; the command of a collection has its own.
"""
