"""What is learned, as digests: a change of the code that should change no tree changes none of these."""
