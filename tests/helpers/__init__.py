"""Cases, closed forms and commands that several tests share."""
