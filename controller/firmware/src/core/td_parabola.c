#include "td_parabola.h"

#include <math.h>

td_parabola td_parabola_fit(int32_t window, double ahead)
{
    double s[5] = {0, 0, 0, 0, 0}, age, power, determinant, c[3][3];
    td_parabola fit;
    int j;

    for (age = 0; age < window; age++) {
        for (power = 1, j = 0; j < 5; power *= age, j++)
            s[j] += power;
    }
    c[0][0] = s[2] * s[4] - s[3] * s[3];
    c[0][1] = c[1][0] = s[2] * s[3] - s[1] * s[4];
    c[0][2] = c[2][0] = s[1] * s[3] - s[2] * s[2];
    c[1][1] = s[0] * s[4] - s[2] * s[2];
    c[1][2] = c[2][1] = s[1] * s[2] - s[0] * s[3];
    c[2][2] = s[0] * s[2] - s[1] * s[1];
    determinant = s[0] * c[0][0] + s[1] * c[0][1] + s[2] * c[0][2];
    for (j = 0; j < 3; j++) {
        fit.value[j] = (c[0][j] - ahead * c[1][j] + ahead * ahead * c[2][j]) / determinant;
        fit.slope[j] = (2 * ahead * c[2][j] - c[1][j]) / determinant;
    }
    return fit;
}

void td_parabola_bend(int32_t window, td_wide *bend)
{
    const double n = window, middle = (n - 1) / 2, g = (3 * n * n - 7) / 20;
    const double size = sqrt(n * (n * n - 1) * (n * n - 4) * (n * n - 9) / 2800);

    bend[0] = (g * middle - middle * middle * middle) / size;
    bend[1] = (3 * middle * middle - g) / size;
    bend[2] = -3 * middle / size;
    bend[3] = 1 / size;
}
