"""Speed beside that of peers, one question per script; results as JSON, of which the documentation makes tables."""
