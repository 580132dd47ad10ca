"""palpate's bus and log measured beside the libraries they stand on and those that others use instead."""
