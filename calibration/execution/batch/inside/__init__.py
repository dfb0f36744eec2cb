"""What runs inside a task on AWS Batch: before its job's containers, around each of their commands, and beside them."""
