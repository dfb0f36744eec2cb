"""What a team has recorded becomes a dataset.

- ``description``: import.yml, which says what there is and how it hangs together;
- ``camera_files``, ``target_files``, ``samples``: intrinsics, patterns and poses in the files of other tools;
- ``pictures``, ``moments``: the files of each camera, and which of them belong together;
- ``bag``, ``messages``: bags of ROS and what is in them; ``survey``: a first pass, without decoding an image;
- ``motion_log``, ``stillness``: how frames and joints move, and when all stands still; ``recordings``: the second pass;
- ``range_data``: clouds, scans and depth images, and the pattern in them;
- ``looking``: the pattern found in them; ``near_miss``: why it is not;
- ``starting_intrinsics``: a lens that nobody knows, from the corners;
- ``relabelling``: the images of a dataset labelled; ``contact_sheet``: a picture of what was found;
- ``best_moments``: which of many moments are kept;
- ``recorded``, ``document``: the dataset; ``importing``: all of it.
"""
