"""Jobs on AWS Batch: several containers in one task, one array for jobs of one shape, results through S3."""
