"""What the `obu` command does, one file a command."""
