"""A network in a process of its own: ``python relay_process.py PORT`` passes datagrams to it and back."""

import select
import socket
import sys

far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
far.connect(("127.0.0.1", int(sys.argv[1])))
near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
near.bind(("127.0.0.1", 0))
print(near.getsockname()[1], flush=True)
caller = None
while True:
    for ready in select.select([near, far], [], [])[0]:
        if ready is near:
            data, caller = near.recvfrom(2048)
            far.send(data)
        elif caller is not None:
            near.sendto(far.recv(2048), caller)
