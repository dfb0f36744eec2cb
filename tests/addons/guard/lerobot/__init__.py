"""Tests of recordings of robot learning."""
