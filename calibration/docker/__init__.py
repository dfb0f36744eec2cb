"""The Docker Engine: the client, and its errors in words for users."""
