// A policy: steers against heading and offset in the lane, and keeps a speed.
//
// A policy of VLAPS is a file, so that no foreign code runs in the tick. This program
// writes one, an ONNX graph of a single layer; `./vlaps swap lane.onnx` gives it to a
// running set, `./vlaps up --policy lane.onnx` starts with it.
//
//     make -C examples/cpp policy
//     target/examples/policy lane.onnx
#include <cstring>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

#include "vlaps.h"

using std::string;

// Protocol buffers: a number, and a text or message, each with the number of its field.
string varint(uint64_t value) {
    string out;
    for (; value >= 128; value >>= 7) out += static_cast<char>(value % 128 + 128);
    return out + static_cast<char>(value);
}
string number(int field, uint64_t value) { return varint(field * 8) + varint(value); }
string text(int field, const string &value) { return varint(field * 8 + 2) + varint(value.size()) + value; }

// A tensor of floats, TensorProto: dims, data_type, name, raw_data.
string tensor(const string &name, const std::vector<uint64_t> &dims, const std::vector<float> &values) {
    string out, raw(values.size() * sizeof(float), '\0');
    std::memcpy(&raw[0], values.data(), raw.size());
    for (uint64_t dim : dims) out += number(1, dim);
    return out + number(2, 1) + text(8, name) + text(9, raw);
}

// An input or output of floats [1, width], ValueInfoProto.
string value(const string &name, uint64_t width) {
    const string shape = text(1, number(1, 1)) + text(1, number(1, width));
    return text(1, name) + text(2, text(1, number(1, 1) + text(2, shape)));
}

string node(const string &operation, const std::vector<string> &inputs, const string &output,
            const string &attributes) {
    string out;
    for (const string &input : inputs) out += text(1, input);
    return out + text(2, output) + text(4, operation) + attributes;
}

int main(int argc, char **argv) {
    const char *path = argc > 1 ? argv[1] : "lane.onnx";
    std::vector<float> weights(2 * VLAPS_FEATURES, 0.0f), bias(2);
    // Feature 2 is 0.5 - 0.5 sin(heading), feature 8 is 0.5 - offset / 4.5 m.
    weights[2] = 2.0f, weights[8] = 0.6f, bias[0] = -(2.0f + 0.6f) / 2;
    // Feature 3 is (3.6 speed + 1) / 81; 5 m/s.
    weights[VLAPS_FEATURES + 3] = -10.0f, bias[1] = 10.0f * (3.6f * 5 + 1) / 81;
    const string transposed = text(5, text(1, "transB") + number(3, 1) + number(20, 2));
    const string graph = text(1, node("Gemm", {"features", "weights", "bias"}, "sums", transposed)) +
                         text(1, node("Tanh", {"sums"}, "action", "")) + text(2, "lane") +
                         text(5, tensor("weights", {2, VLAPS_FEATURES}, weights)) +
                         text(5, tensor("bias", {2}, bias)) +
                         text(11, value("features", VLAPS_FEATURES)) + text(12, value("action", 2));
    const string model = number(1, 8) + text(7, graph) + text(8, number(2, 17));
    std::ofstream file(path, std::ios::binary);
    if (!file.write(model.data(), static_cast<std::streamsize>(model.size())).flush()) {
        std::cerr << "policy: cannot write " << path << "\n";
        return 1;
    }
    std::cout << path << ": " << model.size() << " bytes\n";
}
