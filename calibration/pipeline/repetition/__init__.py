"""The same work several times: how long each run takes, what differs between them, and from which stage on.

- ``repetition``: how often, and one run: its times, outcomes, numbers, transforms and the hashes of its outputs;
- ``results``: runs beside each other: spreads, the first stage that differs, and the verdict;
- ``running``: the loop, over the stages of a run too, and the report; the command of a collection has its own stages.
"""
