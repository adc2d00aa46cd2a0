"""Options and help of commands; the work of each is imported when it is called."""
