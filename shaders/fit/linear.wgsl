// Small systems, as fit/linear.rs.

fn factor(size: u32) -> bool {
    for (var i = 0u; i < size; i++) {
        for (var j = 0u; j <= i; j++) {
            var rest = matrix[i * size + j];
            for (var k = 0u; k < j; k++) {
                rest -= matrix[i * size + k] * matrix[j * size + k];
            }
            if i == j {
                if !(rest > 0.0) {
                    return false;
                }
                matrix[i * size + i] = sqrt(rest);
            } else {
                matrix[i * size + j] = rest / matrix[j * size + j];
            }
        }
    }
    return true;
}

fn substitute(size: u32) {
    for (var i = 0u; i < size; i++) {
        var rest = vector[i];
        for (var k = 0u; k < i; k++) {
            rest -= matrix[i * size + k] * vector[k];
        }
        vector[i] = rest / matrix[i * size + i];
    }
    for (var back = 0u; back < size; back++) {
        let i = size - 1u - back;
        var rest = vector[i];
        for (var k = i + 1u; k < size; k++) {
            rest -= matrix[k * size + i] * vector[k];
        }
        vector[i] = rest / matrix[i * size + i];
    }
}
