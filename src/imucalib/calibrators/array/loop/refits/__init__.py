"""Joint fits with more than one term in question: twins, a lag that all share, several at once."""
