"""`obu set-up`: what a drive shows of the installation, and the settings that follow."""
