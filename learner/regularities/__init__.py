"""What the demonstrations have in common and the tree does not reproduce: doubts (CONTRACT, section 3).

places (where to, that no frame tells), precision (places too near to tell apart), visits (places on the way), returns
 (put back where it stood),
 choices (several goals), doubting (all of them). Each looks at what was understood and calls none of the others.
"""
