"""What came of jobs: outcomes held against what AWS knows, files checked and landed."""
