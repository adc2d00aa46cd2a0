"""What every page of the project needs on the server: files, bodies, limits, streams, the installed map."""
