"""What is asked of AWS: the queue, what runs in it, its logs; every error is one line."""
