"""`obu centre`: run and manage a control centre."""
