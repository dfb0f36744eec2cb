"""Docker Engine: client, and conversion of its errors to messages for users."""
