"""What AWS Batch is asked, made without asking it: jobs by their shape, checked, as definitions and submissions."""
