"""LED images to sub-pixel spot centres with covariance."""
