"""Numbers of a job: units, formulas, fields in space, and the schema that job files are checked against."""
