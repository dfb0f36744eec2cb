"""What goes to S3 and is found there: what mounts hold, jobs, what an earlier run has left."""
