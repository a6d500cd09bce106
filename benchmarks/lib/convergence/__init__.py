"""Problems of the literature are solved from random cold starts by us and by IPOPT."""
