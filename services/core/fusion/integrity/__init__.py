"""Protection levels and the statistics of the innovations behind them."""
