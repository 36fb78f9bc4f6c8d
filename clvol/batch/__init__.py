"""Many pictures in one job, shared by processes and machines.

claims.py   who renders what, agreed by files in a shared folder
"""
