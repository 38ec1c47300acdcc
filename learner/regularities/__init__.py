"""What the demonstrations have in common and the tree does not reproduce: doubts (CONTRACT, section 3), and questions.

places (where to, that no frame tells), precision (places too near to tell apart), turns (orientations), kinds (equal
parts), choices (several goals), visits (places on the way), returns (put back where it stood), exceptions (what a few
do), doubting (all of them), questions (what to show next where a frame is not certain). Each looks at what was
understood and calls none of the others.
"""
