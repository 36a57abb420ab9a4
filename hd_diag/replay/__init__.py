"""The monitor over recorded bags: events of a log, the recorded monitor, replay."""
