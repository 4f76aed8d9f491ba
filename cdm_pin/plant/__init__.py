"""Independent simulators; nothing here knows the identifier or its catalogue."""
