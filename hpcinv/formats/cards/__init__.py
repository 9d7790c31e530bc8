"""Material cards of other programs: read as the section ``material`` of a job, and written from it."""
