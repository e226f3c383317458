"""Where the frozen program begins: worker processes of it begin here too, and leave at the first line."""

import multiprocessing

multiprocessing.freeze_support()

if __name__ == "__main__":
    from app.__main__ import main

    main()
