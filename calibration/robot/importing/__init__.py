"""Import of recordings as datasets.

- ``description``: import.yml, which describes the sensors, the files and the frames;
- ``files``: images, intrinsics, patterns and poses in the files of other tools;
- ``bags``: bags of ROS: their messages, motion and moments at standstill;
- ``image_views``: the patterns in images; ``near_miss``: why one is not found;
- ``videos``, ``cloud_files``: videos and point clouds in files;
- ``mounting``: where its sensors and patterns are mounted;
- ``recorded``: the best moments, and the collections of the dataset; ``document``: its ``dataset.json``;
- ``look``: a preview of a recording, before it is imported or while it is made (``arrivals``);
- ``printed_sheet``: boards to print;
- ``importing``: the whole import; ``amending``: collections added to a dataset, its images labelled again;
- ``results``: what they report.
"""
