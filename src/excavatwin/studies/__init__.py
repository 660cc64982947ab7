"""Studies: what each part of the method is worth, the paper's tables, and ground filtering on its own."""
