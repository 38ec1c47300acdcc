"""The keeping edge: the lake of demonstrations, the store of trees, and how both are served."""
