"""Distribution files of data sets: `clsco dataset make FILE -o DATA --count N`."""
