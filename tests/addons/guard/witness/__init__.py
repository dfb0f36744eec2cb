"""Tests of cameras that move."""
