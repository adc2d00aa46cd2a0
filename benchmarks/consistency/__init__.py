"""Whether the filter's errors are as large as its covariance says, over independent simulated drives."""
