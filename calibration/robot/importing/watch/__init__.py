"""Images that arrive while a recording is made.

- ``arrivals``: the files, each once it is written; ``judging``: whether an image is used, and why not.
"""
