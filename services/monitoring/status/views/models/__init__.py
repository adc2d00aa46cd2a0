"""What the views return: the models of the API, and of the state that the dashboard follows."""
