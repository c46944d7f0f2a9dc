"""Two hosts: messages that carry their age, and the sockets they travel by."""
