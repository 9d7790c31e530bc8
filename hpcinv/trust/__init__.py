"""How far an answer may be trusted: certificate, accuracy, sensitivities."""
