"""Problems that no default was made for, each solved twice: by the product and by an independent twin."""
