"""Reports of coverage in the forms that are in use, as one form."""
