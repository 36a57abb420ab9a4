"""Running nodes in the terminal: what is known of them (`state`), how it arrives, how it is shown."""
