"""Collection of datasets: play a motion, label and check every sensor's data, write the dataset."""
