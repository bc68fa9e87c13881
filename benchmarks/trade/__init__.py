"""What speed and accuracy are traded on: the scenes with all that a user asks of them, and the
rungs from long steps to short ones.
"""
