"""Link between two hosts: messages that carry their age, and the sockets that carry them."""
