"""A dataset in the layouts that training tools read, split into train, valid, and test."""
