"""The sensor simulator of AlpaSim, a closed-loop simulator of NVIDIA, as a gRPC service: scenes with rain."""
