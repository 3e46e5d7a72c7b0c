"""Importing scenes: keyframes with their camera views, from any data set."""
