"""OpenCL: devices, programs, structs, checked arguments. No other folder imports pyopencl."""
