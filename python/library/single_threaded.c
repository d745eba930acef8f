// Debian's archives are made for programs, and reach this variable of glibc in a way that a shared library cannot. Its
// own, at zero, says what is always right: that there may be threads.
char __libc_single_threaded = 0;
