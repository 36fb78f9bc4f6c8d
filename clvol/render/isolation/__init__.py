"""Devices in processes of their own, so that a driver that crashes or hangs takes nothing else down.

channel.py         messages: JSON objects over a socket, with descriptors of files
segments.py        memory that processes share: pictures, voxels
scene_message.py   a resolved scene as JSON, and back
shared_volumes.py  its volumes: shared, mapped, or opened again
process.py         the process of a device, as its Renderer sees it
member.py          the device as a member of a group, and the pictures that it renders
worker.py          what runs in the process
"""
