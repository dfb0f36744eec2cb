"""Code that runs inside a task on AWS Batch: before its containers, around their commands, and beside them."""
