"""Many runs, and what is learnt from them: sweeps, studies, identification, fitting, serving, evidence."""
