"""What is seen: teach, understand, running; each in the frame that all share, trees as tree_view shows them."""
