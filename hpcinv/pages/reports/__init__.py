"""Reports: one HTML file to look at, made from what a run, a sweep or a study has left."""
