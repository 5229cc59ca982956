"""Distribution files of data sets: `clsco batch FILE -o DATA --count N`."""
