"""Work shared by the workers of a dask cluster: processes of this machine, or of many.

connection.py   local workers, or a cluster that exists
local.py        the processes of local workers (process.py), which are replaced when they die
facts.py        what a worker must have in common with the client: version, kernels, files
queue.py        hands tasks to workers, each until it is done once; leaves out workers that do not fit
worker.py       what a worker does
frames.py       the frames of an animation
pictures.py     the pictures of a job

A task is a short text of JSON: names of files, digests of what is in them, settings. No volume is sent, since data
that is scattered dies with the worker that holds it, and each worker loads a volume once.
"""
