"""Jobs for a Kubernetes cluster: written out, not run."""
