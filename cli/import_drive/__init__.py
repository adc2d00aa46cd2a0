"""CSV files of a drive become typed messages: the mapping says how, and nothing here touches a file."""
