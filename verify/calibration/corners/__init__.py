"""Board corners with covariance."""
