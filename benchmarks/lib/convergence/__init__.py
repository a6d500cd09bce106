"""Problems of the literature from random cold starts, ours and IPOPT's."""
