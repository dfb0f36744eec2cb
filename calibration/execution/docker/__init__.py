"""Jobs in containers of a Docker Engine."""
