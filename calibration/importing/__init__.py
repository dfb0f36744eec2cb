"""Import of recordings as datasets.

- ``description``: import.yml, which describes the sensors, the files and the frames;
- ``camera_files``, ``target_files``, ``samples``: intrinsics, patterns and poses in other tools' files
  (``structured_files``: their formats; ``pose_files``, ``pose_form``: what is a pose there, and how it is written);
- ``pictures``: the image files of each camera, and their association across cameras;
- ``bag``, ``messages``: bags of ROS and their messages; ``survey``: a first pass, without decoding images;
- ``motion_log``, ``stillness``: motion of frames and joints, moments at standstill; ``recordings``: the second pass;
- ``range_views``: clouds, scans and depth images, by modality; ``range_data``: the detection of the patterns in them;
- ``image_views``: detection of the pattern in images; ``near_miss``: causes of missing detections;
- ``starting_intrinsics``, ``baselines``: initial guess of unknown intrinsics, from the corners, and of transforms
  between the cameras of a Kalibr camchain;
- ``relabelling``: labelling of a dataset's images; ``contact_sheet``: a picture of the detections;
- ``printed_sheet``: boards to print;
- ``best_moments``: selection of the best moments;
- ``recorded``: the collections of the dataset; ``document``: its ``dataset.json``; ``png``: its image files;
- ``look``: a preview of a recording, before it is imported;
- ``importing``: the whole import; ``results``, ``report``: what it reports.
"""
