"""Speed beside that of peers, one question per script; results as JSON, from which the documentation makes its tables."""
