"""Episodes at control level: how they are played, what is told of them."""
