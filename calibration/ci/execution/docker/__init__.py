"""Backend for jobs in containers of a Docker Engine."""
