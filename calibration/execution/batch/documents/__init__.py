"""What the client and a task write for each other, as JSON; read without trust."""
