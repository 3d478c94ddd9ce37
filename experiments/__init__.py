"""One question per script; results as CSV, figures from the CSV and the images beside it."""
