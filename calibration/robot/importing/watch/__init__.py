"""Images that arrive while a recording is made.

- ``arrivals``: the files, each once it is written; ``followed_bag``: those that are taken from a bag;
  ``judging``: whether an image is used, and why not.
"""
