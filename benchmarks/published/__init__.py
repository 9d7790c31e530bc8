"""Values that others published, next to ours with our error bar: ``python -m benchmarks.published [SOURCE …]``.

A source is a folder with jobs, a table ``references.csv`` and a ``README.md``. `references` reads the table, `runs`
solves the jobs, `comparison` judges the rows, `page` writes the documentation page and its picture.
"""
